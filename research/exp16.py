import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from twinct.recon.ray_weights import RayWeights,error_of_model
from twinct.recon.air import noise_in_air
from twinct.recon.levels import Level
from twinct.recon.order import spread_order
from twinct.recon.working import WorkingVolume
from twinct.recon.ordered_subsets import Minimiser
import twinct.recon.strength as ST
def newfast(A,p,photons,most=12,coarse=2,levels=3,relax=1.5,cb=None,times=None,tol=.02):
    known=None if photons is None else np.full(len(A),float(photons))
    noise=noise_in_air(p,None,known)
    before=None; rho=1.0; T=time.perf_counter(); times={} if times is None else times
    for factor in [2**n for n in reversed(range(levels))]:
        if min(*A.domain_shape,*A.range_shape[1:])//factor<8 and factor>1: continue
        level=Level.of(A,p,None,factor,0.0,before); work=WorkingVolume(A.kernels,level.start())
        n=(1 if factor==1 else max(1,round(coarse*factor/2)))*len(A)
        lastr=relax*min(1.0,float(np.mean(level.A.domain_shape))/len(A))
        for view,share in zip(np.resize(spread_order(len(A)),n),np.geomspace(relax,lastr,n)):
            level.update(work,int(view),float(share),0.0,False)
        x=work.array; times[f"sart{factor}"]=time.perf_counter()-T; T=time.perf_counter()
        if factor<=2:
            nl=None if noise is None else type(noise)(noise.in_air/factor,noise.source)
            w=RayWeights.of(nl,len(A),error_of_model(level.A,x))
            if factor==2:
                t=ST.tried(level,x,w,0.0)
                if t is not None: rho=t.factor
                times["trial"]=time.perf_counter()-T; times["n"]=0 if t is None else len(t.factors); T=time.perf_counter()
            else:
                m=Minimiser(level,x,w,0.0); m.strength=ST.Forces.of(m).strength(rho)
                for k in range(most):
                    if k>1 and m.change<tol: break
                    m.one_pass()
                    if cb: cb(m.x)
                x=m.x
                times[f"os{factor}"]=time.perf_counter()-T
        before=(level,level.whole(x)) if factor>1 else None
    return level.whole(x),rho
if __name__=="__main__":
  tot=[]
  for f in sys.argv[1:]:
   for l in open(f):
    r=json.loads(l); s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    t=time.perf_counter(); sart(A,p,iterations=2,relaxation=1.0,nonnegative=True); tp=(time.perf_counter()-t)/2
    errs=[]; tm={}
    x,rho=newfast(A,p,s.photons,times=tm,cb=lambda x: errs.append(s.error(x)/r['sart'][0]))
    k=tm.pop("n"); T=sum(tm.values())/tp
    tot.append((errs[-1],T/max(5,r['sart'][1]),r['fast']/r['sart'][0]))
    print(f"{r['seed']} {r['family']:9s} n{r['n']} v{len(A)} ph {r['photons'] and round(r['photons'])} sart@{r['sart'][1]} fast {r['fast']/r['sart'][0]:.2f} | rho {np.log2(rho):.1f} of {k} @{len(errs)} {errs[-1]:.2f} t {T:.1f}",{q:round(v/tp,2) for q,v in tm.items()},flush=True)
  v=np.array(tot); print("new median %.3f p95 %.3f max %.2f; fast now %.3f %.3f %.2f; time %.2f %.2f"%(np.median(v[:,0]),np.percentile(v[:,0],95),v[:,0].max(),np.median(v[:,2]),np.percentile(v[:,2],95),v[:,2].max(),np.median(v[:,1]),np.percentile(v[:,1],95)))
